"""A descriptor made from a raw log: what names and numbers agree on is concluded, the rest is asked."""
