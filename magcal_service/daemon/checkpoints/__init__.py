"""What is kept on disk over a restart: verified files (``files``), none older than once (``floor``), and when they are
written (``store``).

Imports the pipeline of the daemon, config, the counter's file of the links and the ground.
"""
