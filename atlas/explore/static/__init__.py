"""An atlas as one HTML file that any browser shows, without a server and without this package."""
