"""What is kept on disk over a restart: verified files (``files``), and when they are written (``store``).

Imports the pipeline of the daemon, config and the ground.
"""
