"""Systems, their parameters, and the matrices of a machine as blocks."""
