"""Opt-in benchmarks, each with its bounds: `python -m benchmarks` fails where one does not
hold. This package imports the standard library alone, so that what it starts is measured
in a process of its own."""
