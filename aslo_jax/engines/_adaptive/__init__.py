"""Continuous time: lanes that each take Runge-Kutta steps of their own."""
