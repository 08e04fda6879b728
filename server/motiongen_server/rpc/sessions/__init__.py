"""Sessions as the edge knows them: the way of their events, and what is kept of them for a client that is lost."""
