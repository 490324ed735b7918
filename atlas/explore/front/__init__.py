"""The front-end of both pages: modules of JavaScript that draw planes from codes and numbers of their cells."""
