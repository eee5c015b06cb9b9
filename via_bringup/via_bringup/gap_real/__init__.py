"""Diagnosis of two real robots from public recordings, and the page that tells it: `via gap real`."""
