"""What may go wrong unseen: flights of known truth, what is done to them, how the daemon fares (``integrity``)."""
