# SPDX-License-Identifier: AGPL-3.0-or-later
# The comparisons of a study from its CSV, by R alone: Rscript study.R animals.csv
# A row each, of two animals or more on either side: treated groups against the control of their
# week (of all weeks where it has none), and treated groups with each other, week by week.
d <- read.csv(commandArgs(TRUE)[1], stringsAsFactors = FALSE)
d <- d[d$measure == "density" & d$included == "yes", ]

compare <- function(kind, group, week, against, a, b) {
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
  r <- data.frame(kind = kind, group = group, week = week, against = against,
    difference = mean(a) - mean(b), p = t$p.value, difference_lower = t$conf.int[1],
    difference_upper = t$conf.int[2], loss_percent = 100 * (1 - rho),
    loss_lower = 100 * (1 - (B + root) / A), loss_upper = 100 * (1 - (B - root) / A),
    p_permutation = perm, hedges_g = J * (mean(a) - mean(b)) / s, hedges_g_lower = end(0.975),
    hedges_g_upper = end(0.025))
  if (kind != "against control") r[c("loss_percent", "loss_lower", "loss_upper")] <- NA
  r
}

treated <- sort(unique(d$group[d$role == "treated"]), method = "radix") # as bytes, not a language
controls <- unique(d$group[d$role == "control"])
losses <- list()
between <- list()
for (i in seq_along(treated)) for (w in sort(unique(d$week[d$group == treated[i]]))) {
  a <- d$value[d$group == treated[i] & d$week == w]
  b <- d$value[d$role == "control" & d$week == w]
  if (length(b) == 0) b <- d$value[d$role == "control"]
  if (length(a) < 2 || length(b) < 2) next
  losses[[length(losses) + 1]] <- compare("against control", treated[i], w, controls, a, b)
  for (other in treated[-seq_len(i)]) {
    b <- d$value[d$group == other & d$week == w]
    if (length(b) > 1)
      between[[length(between) + 1]] <- compare("between groups", treated[i], w, other, a, b)
  }
}
losses <- do.call(rbind, losses)
losses$p_holm <- p.adjust(losses$p, "holm")
between <- do.call(rbind, between)
if (!is.null(between)) between$p_holm <- p.adjust(between$p, "holm")
write.csv(rbind(losses, between), stdout(), row.names = FALSE, na = "")
