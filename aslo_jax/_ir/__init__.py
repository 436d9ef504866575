"""The intermediate representation: a graph of scalar operations, a loop over time made of
its nodes, and what is asked of both."""
