"""Orbits as equations of their impacts: branches in one parameter, curves of bifurcations and grazes in two."""
