"""May an input be used: its age, whether it can be true, and what a lasting disagreement means."""
