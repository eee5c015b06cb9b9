"""Motions that separate candidates which one log cannot."""
