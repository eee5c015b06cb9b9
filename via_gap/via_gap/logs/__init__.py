"""What a recording can answer: the noise of its channels and the quality of its samples."""
