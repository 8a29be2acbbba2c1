"""Several recordings of one craft together: physics shared, nine errors and start states of their own.

Imports the diagnosis of one recording and what that may import.
"""
