"""The front end of both pages: JavaScript modules that draw planes from codes and numbers of their cells."""
