// What edges say for a placement, in units of log odds.
#pragma once

namespace horopter {

double Logistic(double log_odds);

// What is told of an answered object, that it and its pose are right: from the probability that it
// was answered for (kAnsweredLogOdds) and that of its turn.
double StatedProbability(double probability, double pose_probability);

// How much likelier that something is none of the catalog is than with kNominalUnknownShare: the
// ratio of the odds. 1 with that share.
double UnknownOdds(double unknown_share);

// A probability that holds with kNominalUnknownShare, with another share.
double WithUnknownShare(double probability, double unknown_share);

}  // namespace horopter
