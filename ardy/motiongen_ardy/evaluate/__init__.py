"""Evaluates a model: adherence to text and constraints, feet, starts and stops, seams, long sessions."""
