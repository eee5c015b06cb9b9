"""Real time: the loop of simulator, two estimators and controller at 1 kHz."""
