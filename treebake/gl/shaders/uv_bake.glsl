// Draws triangles at their texture coordinates: which face each texel lies on, and where.
#ifdef VERTEX_STAGE
in vec2 in_uv;
in vec3 in_face;  // weights of the second and the third corner, and the face's number
out vec3 face;

void main() {
    gl_Position = vec4(in_uv * 2.0 - 1.0, 0.0, 1.0);  // row 0 is what OpenGL reads first
    face = in_face;
}
#endif

#ifdef FRAGMENT_STAGE
in vec3 face;
layout(location = 0) out vec4 texel;

void main() {
    texel = vec4(face.xy, round(face.z), 1.0);
}
#endif
