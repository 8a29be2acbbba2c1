"""The wire: typed messages to and from bytes, without any input or output of its own.

Imports base alone.
"""
