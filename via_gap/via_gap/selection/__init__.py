"""Which parts of the recordings are fitted and which are held out."""
