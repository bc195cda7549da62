# SPDX-License-Identifier: AGPL-3.0-or-later
# The comparisons of a study from its CSV, by R alone: Rscript study.R animals.csv
# A line each: group week mean_diff p lower upper loss loss_lower loss_upper p_permutation p_holm g
d <- read.csv(commandArgs(TRUE)[1], stringsAsFactors = FALSE)
d <- d[d$measure == "density" & d$included == "yes", ]
rows <- list()
for (g in sort(unique(d$group[d$role == "treated"]))) for (w in sort(unique(d$week[d$group == g]))) {
  a <- d$value[d$group == g & d$week == w]
  b <- d$value[d$role == "control" & d$week == w]
  t <- t.test(a, b)
  rho <- mean(a) / mean(b)
  va <- var(a) / length(a)
  vb <- var(b) / length(b)
  v <- va + rho^2 * vb
  df <- v^2 / (va^2 / (length(a) - 1) + (rho^2 * vb)^2 / (length(b) - 1))
  q <- qt(0.975, df)
  A <- mean(b)^2 - q^2 * vb
  B <- mean(a) * mean(b)
  C <- mean(a)^2 - q^2 * va
  root <- sqrt(B^2 - A * C)
  pool <- c(a, b)
  ways <- combn(length(pool), length(a))
  diffs <- apply(ways, 2, function(i) abs(mean(pool[i]) - mean(pool[-i])))
  perm <- mean(diffs >= abs(mean(a) - mean(b)) - 1e-12)
  nu <- length(a) + length(b) - 2
  s <- sqrt(((length(a) - 1) * var(a) + (length(b) - 1) * var(b)) / nu)
  J <- exp(lgamma(nu / 2) - lgamma((nu - 1) / 2)) / sqrt(nu / 2)
  k <- sqrt(1 / length(a) + 1 / length(b))
  tp <- (mean(a) - mean(b)) / s / k
  end <- function(p) J * k * uniroot(function(x) pt(tp, nu, x) - p, c(tp - 30, tp + 30),
                                     tol = 1e-10)$root
  rows[[length(rows) + 1]] <- data.frame(group = g, week = w, difference = mean(a) - mean(b),
    p = t$p.value, difference_lower = t$conf.int[1], difference_upper = t$conf.int[2],
    loss_percent = 100 * (1 - rho), loss_lower = 100 * (1 - (B + root) / A),
    loss_upper = 100 * (1 - (B - root) / A), p_permutation = perm,
    hedges_g = J * (mean(a) - mean(b)) / s, hedges_g_lower = end(0.975), hedges_g_upper = end(0.025))
}
all <- do.call(rbind, rows)
all$p_holm <- p.adjust(all$p, "holm")
write.csv(all, stdout(), row.names = FALSE)
