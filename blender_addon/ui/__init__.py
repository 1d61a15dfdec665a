"""The user interface in Blender: operators, panels, menus, and the table that registers them."""

ADDON = __name__.rpartition(".")[0]  # Package name of the add-on. It differs in an installed extension.
