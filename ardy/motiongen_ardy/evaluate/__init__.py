"""How good is a model: obedience to text and constraints, feet, starts and stops, seams, long sessions."""
