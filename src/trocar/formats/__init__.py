"""URDF, SDF, MJCF and mesh files: write rigs, read robots and objects.

A module with a `FORMAT` is a format (`format.py`); `export` and `importing` are the doors.
"""
