"""What is kept on disk over a restart: sound files (``files``), and when they are written (``store``).

Imports the pipeline of the daemon, config and the ground.
"""
