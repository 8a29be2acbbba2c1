"""``report.html``: one file that opens without a network.

Imports what the diagnosis has found, the physics it names and the page's style; no step of the search.
"""
