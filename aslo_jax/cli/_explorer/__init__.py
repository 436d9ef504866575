"""The explorer: a page in the browser that moves an observer and shows what it does.

Nothing is imported here, so that the page is served while JAX is being imported.
"""
