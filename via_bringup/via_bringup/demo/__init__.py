"""The main job as one command: a real robot's log and a simulated joint, from bags to one page."""
