"""Lay every leaf into its billboard's plane.

A leaf is not projected: it is turned about its centre by the least rotation that brings its normal into the plane's
(a twig piece: its axis into the plane), and then moved along the normal. Projection would shrink a leaf by the cosine
of that turn, and the crown would lose its cover. Normals stay those of the source, so that light falls as it did.
"""

from dataclasses import dataclass

import numpy as np

from treebake.model import Clusters, Doubles, Ints, Leaves, Mesh


@dataclass(frozen=True, eq=False)
class FlatLeaves:
    """The foliage's triangles in the frames of their planes, sorted by leaf.

    face: (M,) int32, the triangle of the foliage mesh. leaf: (M,) int32. corners: (M, 3, 2) float64, along the plane's
    axes (right, up). depth: (M, 3) float64, distance in front of the plane, true for centres. normals: (M, 3, 3)
    float64, the source's, in (right, up, normal).
    """

    face: Ints
    leaf: Ints
    corners: Doubles
    depth: Doubles
    normals: Doubles


def flatten(foliage: Mesh, leaves: Leaves, clusters: Clusters) -> FlatLeaves:
    """Turn and move every leaf into its plane. O(F)."""
    face = np.argsort(leaves.face_leaf, kind="stable")
    leaf = leaves.face_leaf[face]
    plane = clusters.labels
    frames = plane_frames(clusters.normals)
    # Into the plane's frame and turned there, in one matrix per leaf.
    turns = frames[plane] @ turns_into(clusters.normals[plane], leaves)
    centers = np.einsum("nij,nj->ni", frames[plane], leaves.centers)
    centers[:, 2] += clusters.offsets[plane]
    vertices = foliage.faces[face]
    spokes = foliage.positions[vertices].astype(np.float64) - leaves.centers[leaf][:, None, :]
    placed = np.einsum("mij,mkj->mki", turns[leaf], spokes) + centers[leaf][:, None, :]
    normals = np.einsum("mij,mkj->mki", frames[plane[leaf]], foliage.normals[vertices].astype(np.float64))
    return FlatLeaves(
        face=face.astype(np.int32), leaf=leaf, corners=placed[..., :2], depth=placed[..., 2], normals=normals
    )


def plane_frames(normals: Doubles) -> Doubles:
    """Right-handed frames of planes: (K, 3, 3), rows right, up, normal; up is as near to +Y as the plane allows."""
    upright = np.array([0.0, 1.0, 0.0]) - normals[:, 1:2] * normals
    level = np.array([0.0, 0.0, -1.0]) - normals[:, 2:3] * -normals  # for planes that lie flat
    up = np.where((np.abs(normals[:, 1]) < 0.99)[:, None], upright, level)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return np.stack([np.cross(up, normals), up, normals], axis=1)


def turns_into(planes: Doubles, leaves: Leaves) -> Doubles:
    """The least rotation that brings each leaf into the plane whose normal is planes (N, 3): (N, 3, 3)."""
    side = np.where(np.einsum("ij,ij->i", leaves.normals, planes) < 0, -1.0, 1.0)
    across = np.einsum("ij,ij->i", leaves.axes, planes)
    in_plane = leaves.axes - across[:, None] * planes
    length = np.linalg.norm(in_plane, axis=1, keepdims=True)
    # A twig that stands upright on its plane may fall to any side: it falls along the plane's right.
    fallen = np.where(length > 1e-6, in_plane / np.maximum(length, 1e-6), plane_frames(planes)[:, 0])
    twig = leaves.is_twig[:, None]
    start = np.where(twig, leaves.axes, side[:, None] * leaves.normals)
    end = np.where(twig, fallen, planes)
    return least_turns(start, end)


def least_turns(start: Doubles, end: Doubles) -> Doubles:
    """Rodrigues' rotations from unit vectors to others (N, 3), at most a quarter turn away: (N, 3, 3)."""
    axis = np.cross(start, end)
    cross = np.zeros((len(axis), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = axis
    cross[:, [1, 2, 0], [2, 0, 1]] = -axis
    cosine = np.einsum("ij,ij->i", start, end)[:, None, None]
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + cosine))
