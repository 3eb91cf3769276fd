"""The mesh file formats that treebake reads: one file per format, each giving a list of parts."""
