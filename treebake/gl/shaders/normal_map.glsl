// The normal that a tangent-space normal `bump` stands for. All vectors face the viewer's side of the surface; `side` is
// -1 where that is the back. dx, dy and uv_dx, uv_dy: how position and texture coordinates change along two directions in
// the picture, from which the tangent frame comes, so mirrored texture coordinates and back faces need no vertex tangents.
// A glTF normal map's +Y points against v.
vec3 bumped(vec3 facing, float side, vec3 bump, vec3 dx, vec3 dy, vec2 uv_dx, vec2 uv_dy) {
    float det = uv_dx.x * uv_dy.y - uv_dx.y * uv_dy.x;
    vec3 along_u = (dx * uv_dy.y - dy * uv_dx.y) * sign(det);
    vec3 along_v = (dy * uv_dx.x - dx * uv_dy.x) * sign(det);
    vec3 tangent = along_u - facing * dot(facing, along_u);
    float stretch = length(tangent);
    if (stretch == 0.0) return facing;  // no texture direction here
    tangent /= stretch;
    vec3 bitangent = cross(facing, tangent);
    if (dot(bitangent, along_v) > 0.0) bitangent = -bitangent;
    // Seen from behind, glTF reverses the whole bumped normal: a bump on the front is a dent in the back.
    return normalize(side * (tangent * bump.x + bitangent * bump.y) + facing * bump.z);
}
