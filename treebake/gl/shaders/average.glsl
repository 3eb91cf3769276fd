// Averages blocks of factor x factor samples; alpha becomes coverage and the rest is premultiplied by it.
#ifdef VERTEX_STAGE
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);  // one triangle over the window
    gl_Position = vec4(corner, 0.0, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
uniform sampler2D samples;
uniform int factor;

out vec4 mean;

void main() {
    ivec2 origin = ivec2(gl_FragCoord.xy) * factor;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < factor; ++y) {
        for (int x = 0; x < factor; ++x) sum += texelFetch(samples, origin + ivec2(x, y), 0);
    }
    mean = sum / float(factor * factor);
}
#endif
