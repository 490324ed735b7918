"""The live page of the explorer: its HTML, and the JavaScript modules that only it has."""
