"""Many objects: a manifest read, spread over Dask workers, each object recorded, the whole summed up."""
