"""The prompts of characters that are measured."""

PROMPTS = (
    "a person walks forward",
    "a person runs forward",
    "a person waves with the right hand",
    "a person walks and turns left",
    "a person stands still",
)
