"""Mechanical systems: their definitions, their parameters, and their equations of motion as decoupled blocks."""
