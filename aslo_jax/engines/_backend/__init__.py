"""A step of a loop for a processor: the order of its instructions, how many lanes they
take at a time, and which values wait in memory."""
