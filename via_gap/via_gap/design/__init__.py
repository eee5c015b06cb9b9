"""Motions that separate causes which a log cannot."""
