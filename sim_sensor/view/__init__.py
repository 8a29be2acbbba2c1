"""What people look at: the live terminal table and the plots (extra ``view``)."""
