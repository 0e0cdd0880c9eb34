"""Connect a simulated arm to a real one: calibration, identification, configuration, logs."""
