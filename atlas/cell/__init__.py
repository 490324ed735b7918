"""The results and the motion of single cells, each solved in this process."""
