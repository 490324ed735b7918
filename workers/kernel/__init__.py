"""What runs hot: compiled functions of numbers and arrays, without a Python object in them."""
