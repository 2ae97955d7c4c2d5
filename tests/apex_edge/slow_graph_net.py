"""The graph nets once more, edge by edge in plain Python, straight from the papers' formulas.

Graph transformer: Shi et al. 2021, equations 3 to 5. GAT: Velickovic et al. 2018, equations 1 to 6.
GCN: Kipf and Welling 2017, equation 2. Slow on purpose; shares no code with the fast form.
"""

import math

import numpy as np


def random_layers(shapes, rng):
    return {name: rng.normal(size=shape) * 0.7 for name, shape in shapes.items()}


def linear(layers, name, vector):
    weight = layers[f"{name}.weight"]
    bias = layers.get(f"{name}.bias")
    out = []
    for row in range(len(weight)):
        total = 0.0 if bias is None else float(bias[row])
        for column in range(len(vector)):
            total += float(weight[row][column]) * float(vector[column])
        out.append(total)
    return out


def activate(kind, vector):
    if kind == "relu":
        return [value if value > 0 else 0.0 for value in vector]
    if kind == "elu":
        return [value if value > 0 else math.exp(value) - 1.0 for value in vector]
    return vector


def dot(first, second):
    return sum(a * b for a, b in zip(first, second))


def softmax(scores):
    raised = [math.exp(score) for score in scores]
    return [value / sum(raised) for value in raised]


def transformer(spec, layers, hidden, arrows, coded):
    width = spec.hidden // spec.heads
    out = [linear(layers, "conv.lin_skip", h) for h in hidden]
    for node in range(len(hidden)):
        incoming = [(s, e) for s, t, e in arrows if t == node]
        for head in range(spec.heads):
            part = slice(head * width, (head + 1) * width)
            query = linear(layers, "conv.lin_query", hidden[node])[part]
            scores, values = [], []
            for source, edge in incoming:
                key = linear(layers, "conv.lin_key", hidden[source])[part]
                value = linear(layers, "conv.lin_value", hidden[source])[part]
                if spec.edge_mode != "none":
                    added = coded[edge]
                    if spec.edge_mode == "full":
                        added = linear(layers, "conv.lin_edge", added)
                        key = [k + a for k, a in zip(key, added[part])]
                    value = [v + a for v, a in zip(value, added[part])]
                scores.append(dot(query, key) / math.sqrt(width))
                values.append(value)
            for share, value in zip(softmax(scores), values):
                for i in range(width):
                    out[node][head * width + i] += share * value[i]
    return out


def with_loops(arrows, n_nodes):
    return [(s, t) for s, t, _ in arrows if s != t] + [(n, n) for n in range(n_nodes)]


def gat(spec, layers, hidden, arrows):
    width = spec.hidden // spec.heads
    value = [linear(layers, "conv.lin", h) for h in hidden]
    out = [[float(b) for b in layers["conv.bias"]] for _ in hidden]
    for node in range(len(hidden)):
        sources = [s for s, t in with_loops(arrows, len(hidden)) if t == node]
        for head in range(spec.heads):
            part = slice(head * width, (head + 1) * width)
            scores = []
            for source in sources:
                raw = dot(layers["conv.att_src"][0][head], value[source][part])
                raw += dot(layers["conv.att_dst"][0][head], value[node][part])
                scores.append(raw if raw > 0 else 0.2 * raw)
            for share, source in zip(softmax(scores), sources):
                for i in range(width):
                    out[node][head * width + i] += share * value[source][head * width + i]
    return out


def gcn(spec, layers, hidden, arrows):
    looped = with_loops(arrows, len(hidden))
    degree = [sum(1 for _, t in looped if t == node) for node in range(len(hidden))]
    out = [[float(b) for b in layers["conv.bias"]] for _ in hidden]
    for source, target in looped:
        share = 1.0 / math.sqrt(degree[source] * degree[target])
        for i, value in enumerate(linear(layers, "conv.lin", hidden[source])):
            out[target][i] += share * value
    return out


def logits(spec, layers, nodes, edges, edge_features):
    hidden = [activate(spec.activation, linear(layers, "node_encoder", x)) for x in nodes]
    arrows = [(int(s), int(t), edge) for edge, (s, t) in enumerate(zip(*edges))]
    pairs = [(s, t) for s, t, _ in arrows]
    if spec.is_bidirectional:
        arrows += [(t, s, edge) for s, t, edge in arrows]
    if spec.architecture == "diffgraphormer":
        coded = None
        if spec.edge_mode != "none":
            coded = [linear(layers, "edge_encoder", e) for e in edge_features]
        hidden = transformer(spec, layers, hidden, arrows, coded)
    else:
        hidden = {"diffgat": gat, "diffgcn": gcn}[spec.architecture](spec, layers, hidden, arrows)
    hidden = [activate(spec.activation, h) for h in hidden]
    found = []
    for s, t in pairs:
        if spec.head == "sum":
            ends = [a + b for a, b in zip(hidden[s], hidden[t])]
        else:
            ends = hidden[s] + hidden[t]
        found.append(linear(layers, "head", ends)[0])
    return np.array(found)
