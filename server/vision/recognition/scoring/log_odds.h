// What edges say for a placement, in units of log odds.
#pragma once

#include <cstddef>

namespace horopter {

double Logistic(double log_odds);

// What is told of an answered object, that it and its pose are right: from the probability that it
// was answered for (kAnsweredLogOdds) and that of its turn.
double StatedProbability(double probability, double pose_probability);

// What one object says for the scene's cameras and scale, in units of log odds; 0 for support that
// chance may give. support: see JointScore; sharpness: EdgeSupport::Sharpness over all views.
double EdgeLogLikelihoodRatio(double support, double sharpness);

// What the texture on its faces adds to that of an object of this sharpness. texture: log odds, see
// surface_texture.h.
double TextureLogOdds(double texture, double sharpness);

// How much evidence (log odds) chance gives the best of so many objects more than the best of the
// 20 that the decision was learnt with: ln(n / 20), at least 0.
double MultipleTestingPenalty(std::size_t objects);

}  // namespace horopter
