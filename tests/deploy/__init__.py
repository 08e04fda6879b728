"""What deploy/ has, run for real: images, compose file, dashboards, Kubernetes objects."""
