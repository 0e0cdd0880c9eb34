"""The dVRK's interface (CRTK): one core, and the transports that carry it."""
