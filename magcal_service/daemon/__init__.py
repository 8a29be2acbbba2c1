"""The running service: one pipeline a craft, commands, events, output.

Imports links, recordings and every room below them.
"""
