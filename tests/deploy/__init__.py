"""Tests that run the contents of deploy/: images, compose file, dashboard, Kubernetes objects."""
