"""Graph models that rank the edges of a scene: training in PyTorch, export to plain numpy.

Any message-passing model comes in by name, through the entry-point group
``apex_edge.graph_models``: a function ``make(node_names, edge_names, dropout)`` that returns a
``base.EdgeModel``. One that cannot be exported can still be evaluated and be a teacher.
"""
