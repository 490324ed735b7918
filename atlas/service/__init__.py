"""The service: coordinators, workers and commands that compute and watch stores."""
