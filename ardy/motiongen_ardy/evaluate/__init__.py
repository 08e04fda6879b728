"""How good is a model: reconstruction, obedience to text and constraints, sliding feet."""
