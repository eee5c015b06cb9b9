"""`via bench`: speed, memory and endurance, with references measured in the same run."""
