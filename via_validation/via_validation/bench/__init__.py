"""Speed, size and endurance, each beside what it is held against, measured in one run: `via bench`."""
