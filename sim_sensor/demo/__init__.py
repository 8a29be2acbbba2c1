"""``make run``: a simulated flight feeds a daemon over a real link."""
