"""Robot descriptions as labs have them: URDF and MJCF files, read by pinocchio and MuJoCo."""
