"""The user interface in Blender: operators, panels, menus, and the table that registers them."""

ADDON = __name__.rpartition(".")[0]  # Name of the add-on's package, which an installed extension has another of.
