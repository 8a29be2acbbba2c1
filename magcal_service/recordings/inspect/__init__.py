"""What is wrong with a recording itself, before any physics: defects as findings, with what to write to mend them.

Imports the readers and specs of recordings, wire and the ground.
"""
