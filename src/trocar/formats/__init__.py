"""URDF, SDF, MJCF and mesh files: write rigs, read robots and objects."""
