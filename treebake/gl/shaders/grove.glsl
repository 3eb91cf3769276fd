// Where each tree of a draw call stands: an instance a tree.
in vec4 in_place;  // its origin in the world, and its scale
in vec2 in_turn;   // cosine and sine of its turn about +Y, from +Z towards +X
in float in_opacity;  // less than 1 while it changes its representation

float tree_scale() {
    return in_place.w;
}

// From the tree's own axes to the world's, scaled.
mat3 turned(mat3 axes) {
    mat3 turn = mat3(in_turn.x, 0.0, -in_turn.y, 0.0, 1.0, 0.0, in_turn.y, 0.0, in_turn.x);
    return tree_scale() * (turn * axes);
}

vec3 turned_point(vec3 point) {
    return in_place.xyz + turned(mat3(1.0)) * point;
}

// A point of the world as the tree sees it.
vec3 in_turn_back(vec3 point) {
    return transpose(turned(mat3(1.0))) * (point - in_place.xyz) / (tree_scale() * tree_scale());
}
