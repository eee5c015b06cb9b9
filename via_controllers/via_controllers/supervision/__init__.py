"""What drives the motors: the controller, a holding controller or nothing, always within limits."""
