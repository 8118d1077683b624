"""The modules of the robot's package stand on one another, and never in a circle."""

from graphlib import TopologicalSorter

import grimp


def test_no_module_imports_itself_through_others():
    graph = grimp.build_graph("hardware", cache_dir=None)
    modules = [module for module in graph.modules if graph.find_modules_directly_imported_by(module)]
    TopologicalSorter({module: graph.find_modules_directly_imported_by(module) for module in modules}).prepare()
    assert len(modules) > 30
