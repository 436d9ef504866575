"""From a graph to C99: text that any compiler takes, without a library."""
