"""The motion of a model: equations, switching, sticking, engines."""
