"""How far a motion is from a reference, and what needs no skill to reach."""
