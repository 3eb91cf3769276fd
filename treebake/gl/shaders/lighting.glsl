// Lambert under one sun and a two-colour sky, which stand still in the world.
const vec3 SUN_DIRECTION = normalize(vec3(0.5, 0.8, 0.35));
const vec3 SUN = vec3(1.25, 1.15, 1.0);
const vec3 SKY = vec3(0.45, 0.52, 0.62);
const vec3 GROUND = vec3(0.22, 0.20, 0.16);

// The light that a surface of an albedo sends back. normal: unit, on the viewer's side.
vec3 lit(vec3 albedo, vec3 normal) {
    vec3 light = SUN * max(dot(normal, SUN_DIRECTION), 0.0) + mix(GROUND, SKY, 0.5 + 0.5 * normal.y);
    return min(albedo * light, 1.0);  // clipped before samples are averaged, as in a client that draws into 8 bits
}
