"""Hold the simulation to recorded answers of the dVRK's own software."""
