"""What both halves of the program share: errors, progress, and the files that they meet at.

It uses NumPy, the standard library and relative imports only. It is also the package ``blender_addon._exchange``,
because neither half imports the other.
"""
