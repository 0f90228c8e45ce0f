# SPDX-License-Identifier: Apache-2.0
"""Published caustic methods, kept for comparison and chosen by `CausticSettings.method`; none conserves energy."""
