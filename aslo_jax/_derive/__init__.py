"""Observers derived from models: a model's functions as polynomials in what is not
measured, the closure of its equations under differentiation, and the relation that this
gives (theory, section 2; immersion into a state-affine system)."""
