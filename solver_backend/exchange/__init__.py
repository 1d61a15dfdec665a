"""What both halves of the program share: errors, progress, and the files that they meet at.

NumPy and the standard library alone, and relative imports only: the add-on carries this folder byte for byte as
``blender_addon/_exchange`` (``python3 dev.py vendor``), because neither half imports the other.
"""
