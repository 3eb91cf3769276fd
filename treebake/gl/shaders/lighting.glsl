// Lambert under one sun and a two-colour sky, which stand still in the world.
const vec3 SUN_DIRECTION = normalize(vec3(0.5, 0.8, 0.35));
const vec3 SUN = vec3(1.25, 1.15, 1.0);
const vec3 SKY = vec3(0.45, 0.52, 0.62);
const vec3 GROUND = vec3(0.22, 0.20, 0.16);

// How gently the sun fades where many surfaces share a mean normal. FLIP over floor of a chestnut at 256, 128 and 64
// pixels, exposures fitted:         slicings           views
// 0                            1.014 0.915 0.861  1.356 1.117 0.986
// 0.4                          0.988 0.862 0.795  1.277 1.010 0.878
// 0.6                          0.998 0.860 0.781  1.259 0.979 0.842
// each sample lit by itself    0.989 0.860 0.779  1.244 0.966 0.837
const float SUN_SOFTNESS = 0.5;

// sun: the part of its light that is met. up: the normal's vertical part.
vec3 lit_by(vec3 albedo, float sun, float up) {
    vec3 light = SUN * sun + mix(GROUND, SKY, 0.5 + 0.5 * up);
    return min(albedo * light, 1.0);  // clipped before samples are averaged, as in a client that draws into 8 bits
}

// The light that a surface of an albedo sends back. normal: unit, on the viewer's side.
vec3 lit(vec3 albedo, vec3 normal) {
    return lit_by(albedo, max(dot(normal, SUN_DIRECTION), 0.0), normal.y);
}

// The same of many surfaces with this mean albedo and normal, of any length: some face the sun where their mean is
// turned from it, so the mean of their light is softer than the light of their mean.
vec3 lit_softly(vec3 albedo, vec3 normal) {
    normal /= max(length(normal), 1e-6);
    float sun = dot(normal, SUN_DIRECTION);
    return lit_by(albedo, 0.5 * (sun + sqrt(sun * sun + SUN_SOFTNESS * SUN_SOFTNESS)), normal.y);
}
