"""A contract for import-linter: which modules of a package are cores, told by what they are not."""

from fnmatch import fnmatch

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


class CoresContract(Contract):
    """Every module of the packages that is not a shell (adapter, node) is a core and imports nothing forbidden.

    Imports of shells by cores are forbidden too, so that looking at direct imports is enough: what a core imports
    of its own package is again a core. New modules are cores by themselves.
    """

    packages = fields.ListField(subfield=fields.StringField())
    shells = fields.ListField(subfield=fields.StringField())
    forbidden = fields.ListField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Collect each forbidden direct import of a core."""
        found = [
            f"{core} -> {imported}"
            for package in self.packages
            for core in sorted({package, *graph.find_descendants(package)})
            if not self._is_shell(core)
            for imported in sorted(graph.find_modules_directly_imported_by(core))
            if self._is_forbidden(imported, package)
        ]
        return ContractCheck(kept=not found, metadata={"found": found})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the imports found."""
        for line in check.metadata["found"]:
            output.print_error(line, bold=False)

    def _is_shell(self, module: str) -> bool:
        return any(fnmatch(part, shell) for part in module.split(".")[1:] for shell in self.shells)

    def _is_forbidden(self, imported: str, package: str) -> bool:
        root = imported.split(".")[0]
        return root in self.forbidden or (root == package and self._is_shell(imported))
