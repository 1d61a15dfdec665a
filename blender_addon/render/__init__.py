"""Pictures of a baked take: a preview video and a contact sheet, rendered by Workbench without a GPU."""
