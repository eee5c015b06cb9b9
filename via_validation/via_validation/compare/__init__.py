"""All stiffness estimators on the same joints, the same motion and the same noise: `via compare`."""
