def compiled(f):
    return f


fused = reordered = inlined = compiled
