"""Sessions as the edge knows them: the path of their events, and what is kept for clients that are disconnected."""
