"""Run the add-on's command line inside Blender: ``blender --command manifold_mocap``."""

COMMAND = "manifold_mocap"  # Name of the command in Blender.


def run(arguments: list[str]) -> int:
    """Run the add-on's command line inside Blender, and return its exit code."""
    from .main import main

    try:
        return main(arguments, f"blender --command {COMMAND}")
    except SystemExit as done:  # argparse has already printed its help
        return int(done.code or 0)


class Command:
    """The registered command, with the handle that Blender needs to unregister it."""

    def __init__(self) -> None:
        self._handle: object | None = None

    def register(self) -> None:
        """Register the ``blender --command`` of the add-on."""
        import bpy

        self._handle = bpy.utils.register_cli_command(COMMAND, run)

    def unregister(self) -> None:
        """Unregister the ``blender --command`` of the add-on."""
        import bpy

        bpy.utils.unregister_cli_command(self._handle)
        self._handle = None


command = Command()  # The add-on's only command.
