"""Scenarios of load on a running daemon; ``tests.benchmarks.bench_load`` runs them."""
