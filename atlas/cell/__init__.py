"""The results and the motion of single cells."""
