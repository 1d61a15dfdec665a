"""What people see in Blender: operators, panels, menus, and the table that registers them."""
