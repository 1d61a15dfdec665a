"""What both halves of the program share: errors, progress and the files that they meet at; NumPy alone."""
