// The inner product of the occlusion field's ratios, in the widest vectors of the machine.
#pragma once

namespace penumbra::shadows {

/// Receiver points that are worked on together, one in each lane.
inline constexpr int kFieldLanes = 16;

/// sum[c][lane] = sum_j weight[j][lane] sum_i matrix[j][i][c] lobe[i][lane], j < rows, i < terms.
/// in:  three colours c; lobe, weight and sum aligned to 64 bytes
/// threads: reentrant
void sum_bilinear(const float* matrix, int rows, int terms, const float* lobe, const float* weight,
                  float* sum);

}  // namespace penumbra::shadows
