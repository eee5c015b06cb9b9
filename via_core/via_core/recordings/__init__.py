"""Recordings as other tools write them: one reader of tables, units, and guesses of what a column holds."""
