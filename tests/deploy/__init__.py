"""The contents of deploy/, really run: images, compose file, dashboard, Kubernetes objects."""
