"""Section 7 solved numerically, with any motor: proofs of the closed form in `via_controllers.joints.visco_elastic`."""
