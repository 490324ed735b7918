"""Job files that come with the package: ``atlas run NAME`` finds them by name."""
