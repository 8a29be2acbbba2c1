"""Several recordings of one craft together: physics shared, nine errors and start states of their own."""
