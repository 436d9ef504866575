"""From functions on arrays to a graph of operations on numbers (scalarisation)."""
