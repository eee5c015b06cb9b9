"""Controllers of joints, and what they are made of."""
