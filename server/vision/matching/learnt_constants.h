// What matching has learnt from data: log-likelihood ratios of the cues that two features are
// images of one edge or corner. All pairs of views of parts-train, commit b0083f8;
// `matching_learning parts-train train` prints these tables.
#pragma once

#include "server/vision/matching/feature_similarity.h"
#include "server/vision/matching/match_features.h"

namespace horopter {

struct LogRatioTable {
  float low;     // of the first bin
  float step;    // width of a bin
  int bins;      // <= 12
  float weight;  // by logistic regression: cues that say the same count less
  float values[12];
};

// Of the table alone, without its weight: values stand at the middles of the bins, linear between
// them, constant beyond; 0 for NaN.
double TableValue(const LogRatioTable& table, float cue);

// [0]: with the plane's homography as prior, [1]: without.
inline constexpr LogRatioTable kSegmentTables[2][kSegmentCueCount] = {
    {
        // turn
        {0.000f,
         0.1200f,
         10,
         0.867f,
         {1.770f, -0.643f, -0.765f, -1.012f, -1.022f, -1.430f, -1.552f, -1.510f, -2.155f, -2.543f}},
        // flipped
        {-0.5000f, 1.000f, 2, 0.308f, {0.594f, -1.577f}},
        // length ratio
        {0.000f,
         0.1875f,
         8,
         0.548f,
         {1.336f, 0.070f, -0.502f, -0.902f, -1.262f, -1.636f, -1.867f, -1.392f}},
        // better side
        {0.000f,
         6.000f,
         10,
         0.662f,
         {2.709f, 1.803f, 0.996f, 0.281f, -0.215f, -0.803f, -1.487f, -1.963f, -2.095f, -3.284f}},
        // worse side
        {0.000f,
         12.00f,
         10,
         0.149f,
         {4.431f, 3.078f, 1.692f, 0.651f, -0.013f, -0.284f, -0.770f, -0.895f, -1.058f, -1.890f}},
        // contrast ratio
        {0.000f,
         0.2500f,
         8,
         0.243f,
         {1.085f, -0.303f, -0.855f, -1.300f, -1.699f, -1.846f, -2.372f, -2.721f}},
        // strip
        {-0.4000f,
         0.1400f,
         10,
         0.329f,
         {-1.293f, -1.169f, -1.221f, -1.052f, -0.827f, -0.518f, -0.194f, 0.474f, 1.176f, 2.611f}},
        // shift
        {0.000f,
         0.02000f,
         10,
         0.610f,
         {1.392f, 0.767f, 0.172f, -0.476f, -1.046f, -1.635f, -1.760f, -2.340f, -2.524f, -3.509f}},
        // beam
        {0.000f,
         0.1250f,
         8,
         0.816f,
         {-3.110f, -1.206f, -1.061f, -0.840f, -0.688f, 0.312f, 0.309f, 2.283f}},
    },
    {
        // turn
        {0.000f,
         0.1200f,
         10,
         0.642f,
         {0.997f, 0.925f, 0.622f, 0.374f, 0.171f, 0.038f, -0.385f, -0.597f, -1.190f, -1.620f}},
        // flipped
        {-0.5000f, 1.000f, 2, 0.182f, {0.565f, -1.402f}},
        // length ratio
        {0.000f,
         0.1875f,
         8,
         0.695f,
         {1.248f, 0.778f, 0.008f, -0.553f, -1.119f, -1.224f, -1.454f, -1.909f}},
        // better side
        {0.000f,
         6.000f,
         10,
         0.552f,
         {2.823f, 1.840f, 0.977f, 0.190f, -0.291f, -0.885f, -1.567f, -1.795f, -2.054f, -2.390f}},
        // worse side
        {0.000f,
         12.00f,
         10,
         0.297f,
         {5.055f, 3.371f, 1.790f, 0.669f, -0.053f, -0.345f, -0.712f, -1.030f, -1.102f, -1.658f}},
        // contrast ratio
        {0.000f,
         0.2500f,
         8,
         0.385f,
         {1.171f, -0.219f, -0.770f, -1.213f, -1.600f, -1.927f, -2.597f, -3.075f}},
        // strip
        {-0.4000f,
         0.1400f,
         10,
         0.226f,
         {-1.256f, -1.078f, -1.172f, -1.087f, -0.817f, -0.422f, -0.094f, 0.535f, 1.341f, 2.807f}},
        // shift
        {0.000f,
         0.02000f,
         10,
         0.000f,
         {0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f}},
        // beam
        {0.000f,
         0.1250f,
         8,
         0.893f,
         {-3.111f, -0.637f, -0.565f, -0.300f, -0.055f, 0.816f, 1.053f, 2.456f}},
    },
};
inline constexpr LogRatioTable kJunctionTables[2][kJunctionCueCount] = {
    {
        // patch
        {-0.4000f,
         0.1167f,
         12,
         0.584f,
         {-2.924f,
          -2.565f,
          -2.219f,
          -2.351f,
          -1.982f,
          -1.411f,
          -0.729f,
          -0.252f,
          0.654f,
          1.550f,
          3.025f,
          5.190f}},
        // type pair
        {-0.5000f, 1.000f, 3, 0.000f, {0.383f, -0.297f, -0.198f}},
        // arm turn
        {0.000f,
         0.1200f,
         10,
         0.311f,
         {2.679f, 1.182f, 0.467f, -0.303f, -1.110f, -1.482f, -1.716f, -1.695f, -1.586f, -1.562f}},
        // arm count
        {-0.5000f, 1.000f, 3, 0.330f, {0.242f, -0.187f, -0.575f}},
        // point shift
        {0.000f,
         0.02500f,
         10,
         0.376f,
         {2.896f, 1.634f, 0.955f, 0.123f, -0.555f, -1.293f, -1.419f, -2.787f, -2.539f, -3.073f}},
        // epipolar
        {0.000f,
         0.6667f,
         12,
         0.930f,
         {4.579f,
          2.887f,
          2.274f,
          1.829f,
          1.209f,
          0.610f,
          -0.556f,
          -2.344f,
          -1.589f,
          -2.289f,
          -2.216f,
          -7.301f}},
    },
    {
        // patch
        {-0.4000f,
         0.1167f,
         12,
         0.666f,
         {-1.921f,
          -1.816f,
          -1.508f,
          -1.469f,
          -0.972f,
          -0.543f,
          0.108f,
          0.679f,
          1.215f,
          2.070f,
          3.359f,
          5.105f}},
        // type pair
        {-0.5000f, 1.000f, 3, 0.000f, {0.468f, -0.308f, -0.301f}},
        // arm turn
        {0.000f,
         0.1200f,
         10,
         0.262f,
         {1.732f, 1.413f, 0.815f, 0.400f, -0.203f, -0.569f, -0.634f, -0.975f, -0.981f, -0.967f}},
        // arm count
        {-0.5000f, 1.000f, 3, 0.387f, {0.303f, -0.194f, -0.768f}},
        // point shift
        {0.000f,
         0.02500f,
         10,
         0.000f,
         {0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f, 0.000f}},
        // epipolar
        {0.000f,
         0.6667f,
         12,
         1.077f,
         {5.128f,
          3.456f,
          2.795f,
          2.393f,
          1.639f,
          1.068f,
          -0.159f,
          -1.920f,
          -1.074f,
          -1.829f,
          -1.778f,
          -7.350f}},
    },
};
// By the relation of the neighbours; the weight is what a link says without its disagreement.
inline constexpr LogRatioTable kLinkTables[2][kMatchRelationCount] = {
    {
        // segment meets junction
        {0.000f, 0.5000f, 2, 0.368f, {0.368f, 1.696f}},
        // segments share junction
        {0.000f,
         0.1500f,
         8,
         0.156f,
         {0.726f, 0.393f, 0.446f, 0.331f, 0.186f, 0.248f, -0.033f, -1.015f}},
        // segments collinear
        {0.000f,
         0.1500f,
         8,
         1.907f,
         {1.896f, 1.696f, 1.696f, 1.696f, 1.696f, 1.696f, 1.696f, 1.947f}},
        // segments parallel
        {0.000f,
         0.1500f,
         8,
         0.355f,
         {0.669f, -0.096f, 1.696f, 1.696f, 1.696f, 1.696f, 1.696f, -0.630f}},
        // segments of same region
        {0.000f,
         0.1500f,
         8,
         0.439f,
         {1.081f, 0.503f, 0.531f, 0.384f, 0.148f, -0.062f, -0.595f, -0.694f}},
        // junctions of one segment
        {0.000f,
         0.2000f,
         8,
         0.000f,
         {0.968f, -0.732f, -0.425f, -0.786f, -0.965f, -1.907f, -3.222f, -4.906f}},
    },
    {
        // segment meets junction
        {0.000f, 0.5000f, 2, 0.628f, {0.628f, 1.912f}},
        // segments share junction
        {0.000f,
         0.1500f,
         8,
         0.506f,
         {1.269f, 1.106f, 0.825f, 0.314f, 0.196f, -0.297f, -0.941f, -0.692f}},
        // segments collinear
        {0.000f,
         0.1500f,
         8,
         2.097f,
         {2.107f, 1.912f, 1.912f, 1.912f, 1.912f, 1.912f, 1.912f, 1.912f}},
        // segments parallel
        {0.000f,
         0.1500f,
         8,
         1.189f,
         {1.285f, 1.219f, 1.912f, 1.912f, 1.912f, 1.912f, 1.912f, 0.632f}},
        // segments of same region
        {0.000f,
         0.1500f,
         8,
         0.599f,
         {1.425f, 1.223f, 0.941f, 0.412f, 0.111f, -0.803f, -1.707f, -0.785f}},
        // junctions of one segment
        {0.000f,
         0.2000f,
         8,
         0.700f,
         {1.552f, 1.391f, 0.715f, -0.100f, -0.568f, -2.293f, -2.215f, -3.887f}},
    },
};

}  // namespace horopter
