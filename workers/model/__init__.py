"""What oscillates: systems and their parameters, and the matrices of one machine as blocks."""
