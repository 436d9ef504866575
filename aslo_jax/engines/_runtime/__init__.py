"""Kernels as they run: machine code, columns of numbers, threads, the host."""
