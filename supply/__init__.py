"""What the project is made of: licences, locked versions, and the bill of materials of a build."""
