"""One HTML file that shows an atlas in any browser, without a server and without this package."""
