// Levenberg-Marquardt in one dimension: the roughness of one particle.
struct Particle {
    float r;         // roughness
    vec3 fit;        // residual, gradient, curvature at r
    float damping;
};

Particle particle_at(float r) {
    return Particle(r, evaluate(r), 1e-3);
}

void refine(inout Particle p, int steps) {
    for (int i = 0; i < steps; i++) {
        float step = clamp(p.fit.y / (p.fit.z * (1.0 + p.damping) + 1e-20), -0.15, 0.15);
        float r = clamp(p.r + step, ROUGHNESS_MIN, 1.0);
        vec3 fit = evaluate(r);
        if (fit.x < p.fit.x) {
            p.r = r;
            p.fit = fit;
            p.damping = max(p.damping * 0.2, 1e-6);
        } else {
            p.damping = min(p.damping * 8.0, 1e4);
        }
    }
}
