"""The simulated sensor node: orbits, fields, spins, sensor errors and link faults that feed the daemon."""
