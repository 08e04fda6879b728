"""The rows of the table, one subject per file: each adds its figures, and a few takes to look at, to a context."""
